"""How QGIS draws a path: the file beside it, which it reads by itself."""

_SYMBOL = """        <layer class="SimpleLine" enabled="1" pass="0"><Option type="Map">
          <Option name="line_color" type="QString" value="{colour},255"/>
          <Option name="line_width" type="QString" value="{width}"/>
          <Option name="line_width_unit" type="QString" value="MM"/>
          <Option name="capstyle" type="QString" value="round"/>
          <Option name="joinstyle" type="QString" value="round"/>
        </Option></layer>"""
LINE_STYLE = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.28" styleCategories="Symbology">
  <renderer-v2 type="singleSymbol" forceraster="0" enableorderby="0" symbollevels="0">
    <symbols>
      <symbol type="line" name="0" alpha="1" clip_to_extent="1">
{rim}
{line}
      </symbol>
    </symbols>
  </renderer-v2>
  <layerGeometryType>1</layerGeometryType>
</qgis>
""".format(
    rim=_SYMBOL.format(colour="30,30,30", width=1.5),
    line=_SYMBOL.format(colour="213,94,0", width=0.9),
)
"""Of lines: orange, with a dark rim, as in the pictures; layers of points keep QGIS's own."""
